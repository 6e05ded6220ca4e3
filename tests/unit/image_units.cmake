# Pictures and colours of one body whose file is in metres, centimetres or millimetres.
add_test(NAME image_units COMMAND ${CMAKE_CURRENT_LIST_DIR}/image_units.py $<TARGET_FILE:prt_program>)
set_tests_properties(image_units PROPERTIES LABELS "unit")
