# clang-format agrees with every file.
add_test(NAME format COMMAND ${CMAKE_CURRENT_LIST_DIR}/format.sh ${CMAKE_SOURCE_DIR})
set_tests_properties(format PROPERTIES LABELS unit SKIP_RETURN_CODE 77)
