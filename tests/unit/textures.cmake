# Textures through the program: each engine, baked and not; files that lie.
add_test(NAME textures COMMAND ${CMAKE_CURRENT_LIST_DIR}/textures.py $<TARGET_FILE:prt_program>)
set_tests_properties(textures PROPERTIES LABELS "unit")
