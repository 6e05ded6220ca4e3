prt_test(room_limits SOURCES service/room_limits.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_room_limits PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_room_limits relightd prt_program)
