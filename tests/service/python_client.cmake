# Debian's python3 has the packages; another one before it on the PATH may not.
find_program(SYSTEM_PYTHON3 python3 PATHS /usr/bin NO_DEFAULT_PATH)
if(SYSTEM_PYTHON3 AND TARGET python_client)
  add_test(NAME python_client COMMAND ${SYSTEM_PYTHON3}
    ${CMAKE_CURRENT_LIST_DIR}/python_client.py ${CMAKE_BINARY_DIR}/bin ${CMAKE_BINARY_DIR}/python)
  set_tests_properties(python_client PROPERTIES LABELS service SKIP_RETURN_CODE 77)
else()
  message(STATUS "no protoc or python3: the Python client and its test are left out")
endif()
