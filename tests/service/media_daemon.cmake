# A bake of several media served by a live relightd.
add_test(NAME media_daemon COMMAND ${CMAKE_CURRENT_LIST_DIR}/media_daemon.py ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(media_daemon PROPERTIES TIMEOUT 400 LABELS service)
