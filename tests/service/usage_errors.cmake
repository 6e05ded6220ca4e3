# What people type wrongly, in all programs, against a live relightd.
find_program(SYSTEM_PYTHON3 python3 PATHS /usr/bin NO_DEFAULT_PATH)
add_test(NAME usage_errors COMMAND ${SYSTEM_PYTHON3} ${CMAKE_CURRENT_LIST_DIR}/usage_errors.py ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(usage_errors PROPERTIES LABELS service)
