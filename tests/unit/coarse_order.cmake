prt_test(coarse_order SOURCES unit/coarse_order.c ${CMAKE_SOURCE_DIR}/server/ops/view_pace.c
  ${CMAKE_SOURCE_DIR}/libprt/tools/bench/synthetic.c LIBS prt_transport LABELS unit)
target_include_directories(test_coarse_order PRIVATE ${CMAKE_SOURCE_DIR}/libprt/tools/bench ${CMAKE_SOURCE_DIR}/server)
