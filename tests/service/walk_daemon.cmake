# A bake by random walks that a live relightd orders and serves.
add_test(NAME walk_daemon COMMAND ${CMAKE_CURRENT_LIST_DIR}/walk_daemon.py ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(walk_daemon PROPERTIES LABELS service)
