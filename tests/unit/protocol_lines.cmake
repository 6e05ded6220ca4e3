# The length of lines in PROTOCOL.md, and its table of types.
add_test(NAME protocol_lines COMMAND ${CMAKE_CURRENT_LIST_DIR}/protocol_lines.py ${CMAKE_SOURCE_DIR})
set_tests_properties(protocol_lines PROPERTIES LABELS unit)
