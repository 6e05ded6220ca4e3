# Lays everything down in a temporary folder and uses it from there.
add_test(NAME install COMMAND ${CMAKE_CURRENT_LIST_DIR}/install.sh ${CMAKE_COMMAND}
  ${CMAKE_BINARY_DIR} ${CMAKE_SOURCE_DIR} ${CMAKE_C_COMPILER} ${PRT_SANITIZE})
set_tests_properties(install PROPERTIES LABELS unit)
