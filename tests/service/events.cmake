prt_test(events SOURCES service/events.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_events PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_events relightd prt_program)
