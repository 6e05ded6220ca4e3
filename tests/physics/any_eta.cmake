prt_test(physics_any_eta SOURCES ${CMAKE_CURRENT_LIST_DIR}/any_eta.c physics/bodies.c LIBS prt_bake prt_media LABELS physics)
