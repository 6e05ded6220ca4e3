# Variants of a .prt by request.
add_test(NAME variants COMMAND ${CMAKE_CURRENT_LIST_DIR}/variants.py $<TARGET_FILE:prt_program>)
set_tests_properties(variants PROPERTIES LABELS "unit")
