prt_test(subdivide SOURCES ${CMAKE_CURRENT_LIST_DIR}/subdivide.c
  ${CMAKE_SOURCE_DIR}/libprt/tools/bench/subdivide.c
  ${CMAKE_SOURCE_DIR}/libprt/tools/bench/synthetic.c LIBS prt_transport LABELS unit)
target_include_directories(test_subdivide PRIVATE ${CMAKE_SOURCE_DIR}/libprt/tools/bench)
