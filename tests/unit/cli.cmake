# The prt program from outside: words, exit statuses, files.
add_test(NAME cli COMMAND bash ${CMAKE_CURRENT_LIST_DIR}/cli.sh $<TARGET_FILE:prt_program>)
set_tests_properties(cli PROPERTIES LABELS "unit")
