prt_test(options SOURCES unit/options.c
  ${CMAKE_SOURCE_DIR}/libprt/tools/options.c
  ${CMAKE_SOURCE_DIR}/libprt/tools/option_table.c
  ${CMAKE_SOURCE_DIR}/libprt/tools/option_values.c LIBS prt_transport prt_formats LABELS unit)
target_include_directories(test_options PRIVATE ${CMAKE_SOURCE_DIR}/libprt/tools)
target_compile_definitions(test_options PRIVATE PRT_VERSION="test")
