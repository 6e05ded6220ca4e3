# What relight info says about a live relightd's model.
add_test(NAME info_daemon COMMAND ${CMAKE_CURRENT_LIST_DIR}/info_daemon.py ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(info_daemon PROPERTIES LABELS service)
