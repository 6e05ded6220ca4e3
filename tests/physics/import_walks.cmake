prt_test(import_walks SOURCES ${CMAKE_CURRENT_LIST_DIR}/import_walks.c physics/bodies.c LIBS prt_walk prt_media LABELS physics)
