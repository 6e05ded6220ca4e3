# Text of a hostile daemon on the terminal, and the token in the arguments.
find_program(PYTHON3 python3)
if(PYTHON3)
  add_test(NAME relight_terminal COMMAND ${PYTHON3}
    ${CMAKE_CURRENT_LIST_DIR}/relight_terminal.py ${CMAKE_BINARY_DIR}/bin)
  set_tests_properties(relight_terminal PROPERTIES LABELS unit)
else()
  message(STATUS "no python3: the test `relight_terminal` is left out")
endif()
