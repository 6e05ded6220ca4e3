target_link_libraries(prt_raster PRIVATE ${CMAKE_DL_LIBS})
