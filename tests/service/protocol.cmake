# A client written from PROTOCOL.md alone; needs a python3 and nothing else.
find_program(PYTHON3 python3)
if(PYTHON3)
  add_test(NAME protocol COMMAND ${PYTHON3} ${CMAKE_CURRENT_LIST_DIR}/protocol.py
    ${CMAKE_BINARY_DIR}/bin)
  set_tests_properties(protocol PROPERTIES LABELS service)
else()
  message(STATUS "no python3: the test `protocol` is left out")
endif()
