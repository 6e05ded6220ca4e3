add_test(NAME room_hook COMMAND python3 ${CMAKE_CURRENT_LIST_DIR}/room_hook.py ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(room_hook PROPERTIES LABELS service)
