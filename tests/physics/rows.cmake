prt_test(rows SOURCES ${CMAKE_CURRENT_LIST_DIR}/rows.c LIBS prt_bake LABELS physics)
target_include_directories(test_rows PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
