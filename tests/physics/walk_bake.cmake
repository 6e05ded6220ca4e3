prt_test(walk_bake SOURCES ${CMAKE_CURRENT_LIST_DIR}/walk_bake.c physics/bodies.c LIBS prt_bake LABELS physics)
