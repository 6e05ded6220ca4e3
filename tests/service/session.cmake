prt_test(session SOURCES service/session.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_session PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_session relightd prt_program)
