# Previews that are scaled to what walks return.
add_test(NAME preview_walks COMMAND ${CMAKE_CURRENT_LIST_DIR}/preview_walks.py ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(preview_walks PROPERTIES LABELS service)
