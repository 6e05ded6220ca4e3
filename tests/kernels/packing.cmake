prt_test(packing SOURCES ${CMAKE_CURRENT_LIST_DIR}/packing.c LIBS prt_relight LABELS kernels)
target_include_directories(test_packing PRIVATE ${CMAKE_SOURCE_DIR}/libprt
  ${CMAKE_SOURCE_DIR}/libprt/relight)
