# The HTTP port from outside, in Python; needs a python3 and nothing else.
find_program(PYTHON3 python3)
if(PYTHON3)
  foreach(name http_api operation signed_links)
    add_test(NAME ${name} COMMAND ${PYTHON3} ${CMAKE_CURRENT_LIST_DIR}/${name}.py
      ${CMAKE_BINARY_DIR}/bin)
    set_tests_properties(${name} PROPERTIES LABELS service)
  endforeach()
  # Skipped without python3-jsonschema.
  add_test(NAME openapi COMMAND ${PYTHON3} ${CMAKE_CURRENT_LIST_DIR}/openapi.py
    ${CMAKE_BINARY_DIR}/bin ${CMAKE_SOURCE_DIR}/proto/openapi.json)
  set_tests_properties(openapi PROPERTIES LABELS service SKIP_RETURN_CODE 77)
else()
  message(STATUS "no python3: the tests of the HTTP port are left out")
endif()
