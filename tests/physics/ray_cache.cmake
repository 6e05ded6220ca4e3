prt_test(ray_cache SOURCES ${CMAKE_CURRENT_LIST_DIR}/ray_cache.c physics/bodies.c LIBS prt_bake LABELS physics TIMEOUT 600)
target_include_directories(test_ray_cache PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
