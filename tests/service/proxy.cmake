add_test(NAME proxy COMMAND python3 ${CMAKE_CURRENT_LIST_DIR}/proxy.py ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(proxy PROPERTIES LABELS service)
