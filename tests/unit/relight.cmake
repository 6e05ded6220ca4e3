prt_test(relight SOURCES ${CMAKE_CURRENT_LIST_DIR}/relight.c
  ${CMAKE_SOURCE_DIR}/libprt/tools/bench/synthetic.c LIBS prt_relight LABELS unit)
target_include_directories(test_relight PRIVATE ${CMAKE_SOURCE_DIR}/libprt
  ${CMAKE_SOURCE_DIR}/libprt/tools/bench)
