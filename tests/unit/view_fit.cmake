prt_test(view_fit SOURCES unit/view_fit.c LIBS prt_bake LABELS unit)
target_include_directories(test_view_fit PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
