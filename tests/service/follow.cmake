# relight-preview --follow: a room's pictures while people work in it.
add_executable(room_hand ${CMAKE_CURRENT_LIST_DIR}/room_hand.c)
target_link_libraries(room_hand PRIVATE prt_options librelight Threads::Threads)
add_test(NAME follow COMMAND bash ${CMAKE_CURRENT_LIST_DIR}/follow.sh ${CMAKE_BINARY_DIR}/bin
  $<TARGET_FILE:room_hand>)
set_tests_properties(follow PROPERTIES LABELS service)
