add_test(NAME relight_cli COMMAND ${CMAKE_CURRENT_LIST_DIR}/relight_cli.sh ${CMAKE_BINARY_DIR}/bin
  ${CMAKE_C_COMPILER} ${CMAKE_CXX_COMPILER} ${CMAKE_SOURCE_DIR})
set_tests_properties(relight_cli PROPERTIES LABELS unit)
