prt_test(access SOURCES service/access.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_access PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service
  ${CMAKE_SOURCE_DIR}/proto)
add_dependencies(test_access relightd relight prt_program)
