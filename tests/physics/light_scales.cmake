prt_test(light_scales SOURCES ${CMAKE_CURRENT_LIST_DIR}/light_scales.c physics/bodies.c LIBS prt_bake LABELS physics TIMEOUT 600)
