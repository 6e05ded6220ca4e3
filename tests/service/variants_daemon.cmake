# Several media served by a live relightd. Debian's python3 has the packages for its views.
find_program(SYSTEM_PYTHON3 python3 PATHS /usr/bin NO_DEFAULT_PATH)
add_test(NAME variants_daemon COMMAND ${SYSTEM_PYTHON3} ${CMAKE_CURRENT_LIST_DIR}/variants_daemon.py
  ${CMAKE_BINARY_DIR}/bin ${CMAKE_BINARY_DIR}/python)
set_tests_properties(variants_daemon PROPERTIES LABELS service)
