prt_test(door SOURCES service/door.c LIBS librelight relightd_rooms LABELS service TIMEOUT 120)
target_include_directories(test_door PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_door relightd prt_program)
