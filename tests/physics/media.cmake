prt_test(physics_media SOURCES ${CMAKE_CURRENT_LIST_DIR}/media.c physics/bodies.c LIBS prt_bake prt_media LABELS physics)
