prt_test(uploads SOURCES service/uploads.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_uploads PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service
  ${CMAKE_SOURCE_DIR}/proto)
add_dependencies(test_uploads relightd prt_program)
