# External symbols begin with prt_ and relight_.
add_test(NAME symbols COMMAND ${CMAKE_CURRENT_LIST_DIR}/symbols.sh ${CMAKE_BINARY_DIR})
set_tests_properties(symbols PROPERTIES LABELS unit SKIP_RETURN_CODE 77)
