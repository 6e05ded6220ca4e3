prt_test(coefficients SOURCES service/coefficients.c
  ${CMAKE_SOURCE_DIR}/libprt/tools/bench/synthetic.c LIBS librelight relight_proto prt_transport
  LABELS service)
target_include_directories(test_coefficients PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service
  ${CMAKE_SOURCE_DIR}/libprt/tools/bench)
add_dependencies(test_coefficients relightd relight)
