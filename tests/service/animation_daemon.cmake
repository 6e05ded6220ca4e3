# Poses of animations from a live relightd.
add_test(NAME animation_daemon COMMAND ${CMAKE_CURRENT_LIST_DIR}/animation_daemon.py ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(animation_daemon PROPERTIES LABELS service)
