prt_test(serve_client SOURCES unit/serve_client.c ${CMAKE_SOURCE_DIR}/libprt/tools/bench/serve_client.c
  LIBS prt_base relight_proto LABELS unit)
target_include_directories(test_serve_client PRIVATE ${CMAKE_SOURCE_DIR}/libprt
  ${CMAKE_SOURCE_DIR}/libprt/tools/bench ${CMAKE_SOURCE_DIR}/libprt/tools ${CMAKE_SOURCE_DIR}/proto)
