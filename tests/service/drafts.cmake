prt_test(drafts SOURCES service/drafts.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_drafts PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_drafts relightd prt_program)
