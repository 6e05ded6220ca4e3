# Places for bakes that wait or run.
add_test(NAME bake_queue COMMAND ${CMAKE_CURRENT_LIST_DIR}/bake_queue.py ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(bake_queue PROPERTIES LABELS service)
