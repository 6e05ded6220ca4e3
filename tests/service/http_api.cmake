# The HTTP port from outside, in Python; needs a python3 and nothing else.
find_program(PYTHON3 python3)
if(PYTHON3)
  foreach(name http_api operation)
    add_test(NAME ${name} COMMAND ${PYTHON3} ${CMAKE_CURRENT_LIST_DIR}/${name}.py
      ${CMAKE_BINARY_DIR}/bin)
    set_tests_properties(${name} PROPERTIES TIMEOUT 240 LABELS service)
  endforeach()
else()
  message(STATUS "no python3: the tests of the HTTP port are left out")
endif()
