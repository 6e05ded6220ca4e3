prt_test(queries SOURCES ${CMAKE_CURRENT_LIST_DIR}/queries.c
  ${CMAKE_SOURCE_DIR}/libprt/tools/bench/synthetic.c LIBS prt_relight LABELS unit)
target_include_directories(test_queries PRIVATE ${CMAKE_SOURCE_DIR}/libprt
  ${CMAKE_SOURCE_DIR}/libprt/tools/bench)
