# Does every relight figure run and print what a program can read?
add_test(NAME bench COMMAND ${CMAKE_CURRENT_LIST_DIR}/bench.sh $<TARGET_FILE:prt-bench>)
set_tests_properties(bench PROPERTIES LABELS unit)
