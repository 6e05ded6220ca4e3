# What a bake takes, and its limits; of the tool's own files only the watch.
prt_test(memory SOURCES unit/memory.c ${CMAKE_SOURCE_DIR}/libprt/tools/memory.c LIBS prt_base prt_formats
  LABELS unit TIMEOUT 900)
target_include_directories(test_memory PRIVATE ${CMAKE_SOURCE_DIR}/libprt
  ${CMAKE_SOURCE_DIR}/libprt/include)
add_dependencies(test_memory prt_program)
