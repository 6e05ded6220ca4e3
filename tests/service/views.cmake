prt_test(views SOURCES service/views.c LIBS librelight relight_proto LABELS service)
target_include_directories(test_views PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/service)
add_dependencies(test_views relightd prt_program)
