# Animations of glTF against closed forms.
add_test(NAME animation COMMAND ${CMAKE_CURRENT_LIST_DIR}/animation.py $<TARGET_FILE:prt_program>)
set_tests_properties(animation PROPERTIES LABELS "unit")
