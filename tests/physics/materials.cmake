prt_test(materials SOURCES ${CMAKE_CURRENT_LIST_DIR}/materials.c physics/bodies.c LIBS prt_bake LABELS physics)
target_include_directories(test_materials PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
