# Objects, groups and materials of OBJ files, variants of glTF files.
add_test(NAME parts COMMAND ${CMAKE_CURRENT_LIST_DIR}/parts.py $<TARGET_FILE:prt_program>)
set_tests_properties(parts PROPERTIES LABELS "unit")
