prt_test(walk_shards SOURCES ${CMAKE_CURRENT_LIST_DIR}/walk_shards.c physics/bodies.c LIBS prt_bake LABELS physics)
target_include_directories(test_walk_shards PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
