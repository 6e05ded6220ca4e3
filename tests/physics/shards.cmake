prt_test(shards SOURCES ${CMAKE_CURRENT_LIST_DIR}/shards.c physics/bodies.c LIBS prt_bake LABELS physics TIMEOUT 600)
