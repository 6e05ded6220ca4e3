prt_test(shards SOURCES ${CMAKE_CURRENT_LIST_DIR}/shards.c LIBS prt_bake LABELS physics TIMEOUT 600)
