find_library(PRT_OPENBLAS openblas REQUIRED)
find_library(PRT_LAPACKE lapacke REQUIRED)
target_link_libraries(prt_bake PUBLIC ${PRT_LAPACKE} ${PRT_OPENBLAS})
