prt_test(column_kernels SOURCES ${CMAKE_CURRENT_LIST_DIR}/columns.c
  ${CMAKE_SOURCE_DIR}/libprt/tools/bench/synthetic.c LIBS prt_relight LABELS kernels)
target_include_directories(test_column_kernels PRIVATE ${CMAKE_SOURCE_DIR}/libprt
  ${CMAKE_SOURCE_DIR}/libprt/relight ${CMAKE_SOURCE_DIR}/libprt/tools/bench)
