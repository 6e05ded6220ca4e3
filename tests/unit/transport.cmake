prt_test(transport SOURCES ${CMAKE_CURRENT_LIST_DIR}/transport.c
  ${CMAKE_SOURCE_DIR}/libprt/tools/bench/synthetic.c LIBS prt_transport LABELS unit)
target_include_directories(test_transport PRIVATE ${CMAKE_SOURCE_DIR}/libprt/transport
  ${CMAKE_SOURCE_DIR}/libprt/tools/bench)
