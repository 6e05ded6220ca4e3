prt_test(hierarchy SOURCES unit/hierarchy.c LIBS prt_bake LABELS unit)
target_include_directories(test_hierarchy PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
