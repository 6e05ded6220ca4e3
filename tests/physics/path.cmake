prt_test(path SOURCES physics/path.c LIBS prt_bake LABELS physics)
target_include_directories(test_path PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
