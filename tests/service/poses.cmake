prt_test(poses SOURCES service/poses.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_poses PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_poses relightd prt_program)
