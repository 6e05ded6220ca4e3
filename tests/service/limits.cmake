prt_test(limits SOURCES service/limits.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_limits PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_limits relightd prt_program)
