# 5 kills and 100 loads; with --long 50 and 1000.
prt_test(kill_daemon SOURCES fault/kill.c LIBS librelight LABELS fault)
target_include_directories(test_kill_daemon PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_kill_daemon relightd prt_program)
add_test(NAME kill_daemon_long COMMAND test_kill_daemon 50 1000)
set_tests_properties(kill_daemon_long PROPERTIES TIMEOUT 3000 LABELS "fault;long")
