prt_test(walk_smooth SOURCES ${CMAKE_CURRENT_LIST_DIR}/walk_smooth.c LIBS prt_bake LABELS physics)
target_include_directories(test_walk_smooth PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
