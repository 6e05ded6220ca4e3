prt_test(bake_settings SOURCES ${CMAKE_CURRENT_LIST_DIR}/bake_settings.c LIBS prt_bake LABELS unit)
target_include_directories(test_bake_settings PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
