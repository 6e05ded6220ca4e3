# Where the dipole errs, as a false colour.
add_test(NAME difference COMMAND ${CMAKE_CURRENT_LIST_DIR}/difference.py $<TARGET_FILE:prt_program>)
set_tests_properties(difference PROPERTIES LABELS "unit")
