prt_test(room_life SOURCES service/room_life.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_room_life PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_room_life relightd prt_program)
