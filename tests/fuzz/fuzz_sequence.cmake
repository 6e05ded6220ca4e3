include(${CMAKE_CURRENT_LIST_DIR}/_instrumented.cmake)
prt_checked_program(fuzz_sequence
  SOURCES fuzz/fuzz_sequence.c fuzz/answers.c fuzz/messages.c fuzz/any_message.c fuzz/any_fields.c fuzz/world.c fuzz/room_messages.c fuzz/rooms.c
    ${CMAKE_SOURCE_DIR}/libprt/tools/bench/synthetic.c
  ROOMS relightd_rooms relight_proto prt_base prt_medium)
target_include_directories(fuzz_sequence PRIVATE ${CMAKE_SOURCE_DIR}/libprt/tools/bench)
add_test(NAME fuzz_sequence COMMAND fuzz_sequence -s 5 ${CMAKE_SOURCE_DIR}/proto/vectors)
set_tests_properties(fuzz_sequence PROPERTIES LABELS fuzz)
add_test(NAME fuzz_sequence_long COMMAND fuzz_sequence -s 600 ${CMAKE_SOURCE_DIR}/proto/vectors)
set_tests_properties(fuzz_sequence_long PROPERTIES TIMEOUT 1200 LABELS long)
