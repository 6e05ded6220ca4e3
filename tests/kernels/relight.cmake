prt_test(relight_kernels SOURCES ${CMAKE_CURRENT_LIST_DIR}/relight.c
  ${CMAKE_SOURCE_DIR}/libprt/tools/bench/synthetic.c LIBS prt_relight LABELS kernels)
target_include_directories(test_relight_kernels PRIVATE ${CMAKE_SOURCE_DIR}/libprt
  ${CMAKE_SOURCE_DIR}/libprt/relight ${CMAKE_SOURCE_DIR}/libprt/tools/bench)
