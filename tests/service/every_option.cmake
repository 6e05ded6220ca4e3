# Every option of a picture and of colours reaches the answer.
add_test(NAME every_option COMMAND ${CMAKE_CURRENT_LIST_DIR}/every_option.py ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(every_option PROPERTIES LABELS service)
