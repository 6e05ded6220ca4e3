prt_test(walk_free SOURCES ${CMAKE_CURRENT_LIST_DIR}/walk_free.c physics/bodies.c LIBS prt_bake LABELS physics TIMEOUT 600)
