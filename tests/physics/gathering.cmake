prt_test(gathering SOURCES physics/gathering.c physics/bodies.c LIBS prt_bake LABELS physics)
target_include_directories(test_gathering PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
