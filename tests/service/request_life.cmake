prt_test(request_life SOURCES service/request_life.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_request_life PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_request_life relightd prt_program)
