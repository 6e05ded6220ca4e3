# Requests with one fault each, at a live relightd.
find_program(SYSTEM_PYTHON3 python3 PATHS /usr/bin NO_DEFAULT_PATH)
add_test(NAME refusals COMMAND ${SYSTEM_PYTHON3} ${CMAKE_CURRENT_LIST_DIR}/refusals.py
  ${CMAKE_BINARY_DIR}/bin ${CMAKE_BINARY_DIR}/python)
set_tests_properties(refusals PROPERTIES LABELS service)
