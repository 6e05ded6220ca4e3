# relight room against a live relightd. The schemas of BCF 2.1 lie beside the checkout.
add_test(NAME room_cli COMMAND bash ${CMAKE_CURRENT_LIST_DIR}/room_cli.sh ${CMAKE_BINARY_DIR}/bin
  ${CMAKE_SOURCE_DIR}/../shared/data/bcf-2.1)
set_tests_properties(room_cli PROPERTIES LABELS service)
# The same, where nothing is skipped: without the schemas or xmllint it is reported as skipped.
add_test(NAME room_bcf COMMAND bash ${CMAKE_CURRENT_LIST_DIR}/room_cli.sh ${CMAKE_BINARY_DIR}/bin
  ${CMAKE_SOURCE_DIR}/../shared/data/bcf-2.1 bcf)
set_tests_properties(room_bcf PROPERTIES LABELS service SKIP_RETURN_CODE 77)
