prt_test(savings SOURCES ${CMAKE_CURRENT_LIST_DIR}/savings.c physics/bodies.c LIBS prt_bake LABELS physics)
target_include_directories(test_savings PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
