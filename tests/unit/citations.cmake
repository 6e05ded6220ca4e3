# Do the sections, papers and equations that code and pages cite exist?
add_test(NAME citations COMMAND ${CMAKE_CURRENT_LIST_DIR}/citations.sh ${CMAKE_SOURCE_DIR})
set_tests_properties(citations PROPERTIES LABELS unit)
