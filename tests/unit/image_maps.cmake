# Maps over uv from the command line: a tint, a bump, refusals.
add_test(NAME image_maps COMMAND bash ${CMAKE_CURRENT_LIST_DIR}/image_maps.sh $<TARGET_FILE:prt_program>)
set_tests_properties(image_maps PROPERTIES LABELS "unit")
