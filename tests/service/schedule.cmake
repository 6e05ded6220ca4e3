prt_test(schedule SOURCES service/schedule.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_schedule PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_schedule relightd prt_program)
