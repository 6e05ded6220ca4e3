# Two replicas on one folder. The long version does 10,000 random operations.
if(SYSTEM_PYTHON3 AND TARGET python_client)
  # libfaketime replaces pthread_cond_timedwait: the thread sanitizer takes its mutex for held.
  if(PRT_SANITIZE MATCHES thread)
    message(STATUS "clocks is left out: libfaketime does not work beside this sanitizer")
  else()
    add_test(NAME clocks COMMAND ${SYSTEM_PYTHON3}
      ${CMAKE_CURRENT_LIST_DIR}/clocks.py ${CMAKE_BINARY_DIR}/bin ${CMAKE_BINARY_DIR}/python)
    set_tests_properties(clocks PROPERTIES LABELS service SKIP_RETURN_CODE 77)
  endif()
  add_test(NAME replicas COMMAND ${SYSTEM_PYTHON3}
    ${CMAKE_CURRENT_LIST_DIR}/replicas.py ${CMAKE_BINARY_DIR}/bin ${CMAKE_BINARY_DIR}/python 300)
  set_tests_properties(replicas PROPERTIES LABELS service SKIP_RETURN_CODE 77)
  add_test(NAME replicas_long COMMAND ${SYSTEM_PYTHON3}
    ${CMAKE_CURRENT_LIST_DIR}/replicas.py ${CMAKE_BINARY_DIR}/bin ${CMAKE_BINARY_DIR}/python 10000)
  set_tests_properties(replicas_long PROPERTIES TIMEOUT 3000 LABELS "service;long"
    SKIP_RETURN_CODE 77)
endif()
