prt_test(receivers SOURCES ${CMAKE_CURRENT_LIST_DIR}/receivers.c physics/bodies.c LIBS prt_bake LABELS physics)
