prt_test(walk_draft SOURCES ${CMAKE_CURRENT_LIST_DIR}/walk_draft.c physics/bodies.c LIBS prt_bake LABELS physics)
