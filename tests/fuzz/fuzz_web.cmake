include(${CMAKE_CURRENT_LIST_DIR}/_instrumented.cmake)
prt_checked_program(relightd_checked SOURCES ${CMAKE_SOURCE_DIR}/server/core/main.c
  ROOMS relightd_rooms relight_proto prt_base prt_medium)
prt_checked_program(fuzz_web SOURCES fuzz/fuzz_web.c fuzz/messages.c fuzz/any_message.c fuzz/any_fields.c fuzz/world.c fuzz/room_messages.c
    ${CMAKE_SOURCE_DIR}/libprt/tools/bench/synthetic.c
  ROOMS relight_proto LIBS prt_transport)
target_include_directories(fuzz_web PRIVATE ${CMAKE_SOURCE_DIR}/libprt/tools/bench)
foreach(carrier http websocket)
  add_test(NAME fuzz_${carrier} COMMAND fuzz_web -s 4 ${carrier} $<TARGET_FILE:relightd_checked>)
  set_tests_properties(fuzz_${carrier} PROPERTIES LABELS fuzz)
  add_test(NAME fuzz_${carrier}_long COMMAND fuzz_web -s 600 ${carrier}
    $<TARGET_FILE:relightd_checked>)
  set_tests_properties(fuzz_${carrier}_long PROPERTIES TIMEOUT 1320 LABELS long)
endforeach()
