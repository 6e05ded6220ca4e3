include(${CMAKE_CURRENT_LIST_DIR}/_target.cmake)
# The seeds are packed events of random actions.
add_executable(room_seeds fuzz/room_seeds.c)
target_link_libraries(room_seeds PRIVATE prt_options relight_proto)
set_target_properties(room_seeds PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/tests)
set(room_seed_folder ${CMAKE_BINARY_DIR}/tests/room_seeds.d)
file(MAKE_DIRECTORY ${room_seed_folder})
add_custom_command(TARGET room_seeds POST_BUILD COMMAND room_seeds ${room_seed_folder})
prt_fuzz(fuzz_room SOURCES fuzz/fuzz_room.c ROOMS relightd_rooms relight_proto SECONDS 4
  SEEDS ${room_seed_folder})
add_dependencies(fuzz_room room_seeds)
