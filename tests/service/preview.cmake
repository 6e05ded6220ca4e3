# relight and relight-preview with a live relightd, from outside.
add_test(NAME preview COMMAND bash ${CMAKE_CURRENT_LIST_DIR}/preview.sh ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(preview PROPERTIES LABELS service)
