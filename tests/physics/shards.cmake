prt_test(shards SOURCES ${CMAKE_CURRENT_LIST_DIR}/shards.c physics/bodies.c LIBS prt_bake LABELS physics TIMEOUT 1200)
target_include_directories(test_shards PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
