prt_test(drawn_exits SOURCES ${CMAKE_CURRENT_LIST_DIR}/drawn_exits.c physics/bodies.c LIBS prt_bake LABELS physics)
target_include_directories(test_drawn_exits PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
