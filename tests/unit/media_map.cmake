# Media by object through the program: maps, the file's own media, refusals.
add_test(NAME media_map COMMAND ${CMAKE_CURRENT_LIST_DIR}/media_map.py $<TARGET_FILE:prt_program>)
set_tests_properties(media_map PROPERTIES LABELS "unit")
