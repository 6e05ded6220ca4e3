prt_test(products SOURCES ${CMAKE_CURRENT_LIST_DIR}/products.c LIBS prt_bake LABELS physics)
target_include_directories(test_products PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
