find_program(SYSTEM_PYTHON3 python3 PATHS /usr/bin NO_DEFAULT_PATH)
add_test(NAME room_keep COMMAND ${SYSTEM_PYTHON3} ${CMAKE_CURRENT_LIST_DIR}/room_keep.py ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(room_keep PROPERTIES LABELS service)
