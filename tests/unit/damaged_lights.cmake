# Environments with one fault each, read by prt.
find_program(SYSTEM_PYTHON3 python3 PATHS /usr/bin NO_DEFAULT_PATH)
add_test(NAME damaged_lights COMMAND ${SYSTEM_PYTHON3} ${CMAKE_CURRENT_LIST_DIR}/damaged_lights.py ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(damaged_lights PROPERTIES LABELS unit)
