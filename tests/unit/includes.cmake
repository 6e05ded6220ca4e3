# Includes point down the list of rooms.
add_test(NAME includes COMMAND ${CMAKE_CURRENT_LIST_DIR}/includes.py ${CMAKE_SOURCE_DIR})
set_tests_properties(includes PROPERTIES LABELS unit)
