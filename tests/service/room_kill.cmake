prt_test(room_kill SOURCES service/room_kill.c LIBS librelight relightd_rooms relight_proto
  LABELS service)
target_include_directories(test_room_kill PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service
  ${CMAKE_SOURCE_DIR}/server)
add_dependencies(test_room_kill relightd prt_program)
# The length that the promise names.
add_test(NAME room_kill_long COMMAND ${CMAKE_COMMAND} -E env ROOM_SECONDS=30 $<TARGET_FILE:test_room_kill>)
set_tests_properties(room_kill_long PROPERTIES LABELS long)
