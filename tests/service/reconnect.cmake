prt_test(reconnect SOURCES service/reconnect.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_reconnect PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_reconnect relightd relight prt_program)
