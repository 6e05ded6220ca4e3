prt_test(bake SOURCES ${CMAKE_CURRENT_LIST_DIR}/bake.c LIBS prt_bake LABELS physics TIMEOUT 900)
