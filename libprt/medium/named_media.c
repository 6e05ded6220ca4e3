// SPDX-License-Identifier: MIT
// Liquids and powders that NSJ06 measured, undiluted, by the names that pbrt gives them. g
// above 0.95 and sigma_s' below 1e-5 mm^-1 are moved to these bounds (Coke, Sprite and the
// like).
#include "prt/medium.h"

// sigma_s', sigma_a [mm^-1], g
#define MEDIUM(NAME, sr, sg, sb, ar, ag, ab, gr, gg, gb)                      \
    {                                                                         \
        .name = NAME, .sigma_s_prime = {sr, sg, sb}, .sigma_a = {ar, ag, ab}, \
        .g = {gr, gg, gb}, .eta = 1.33f, .roughness = 0.3f                    \
    }
static const struct prt_material media[] = {
    MEDIUM("Lowfat Milk", 0.89187f, 1.5136f, 2.532f, 0.002875f, 0.00575f, 0.0115f, 0.932f,
           0.902f, 0.859f),
    MEDIUM("Reduced Milk", 2.4858f, 3.1669f, 4.5214f, 0.0025556f, 0.0051111f, 0.012778f, 0.819f,
           0.797f, 0.746f),
    MEDIUM("Regular Milk", 4.5513f, 5.8294f, 7.136f, 0.0015333f, 0.0046f, 0.019933f, 0.75f,
           0.714f, 0.681f),
    MEDIUM("Espresso", 0.72378f, 0.84557f, 1.0247f, 4.7984f, 6.5751f, 8.8493f, 0.907f, 0.896f,
           0.88f),
    MEDIUM("Mint Mocha Coffee", 0.31602f, 0.38538f, 0.48131f, 3.772f, 5.8228f, 7.82f, 0.91f,
           0.907f, 0.914f),
    MEDIUM("Lowfat Soy Milk", 0.30576f, 0.34233f, 0.61664f, 0.0014375f, 0.0071875f, 0.035937f,
           0.85f, 0.853f, 0.842f),
    MEDIUM("Regular Soy Milk", 0.59223f, 0.73866f, 1.4693f, 0.0019167f, 0.0095833f, 0.065167f,
           0.873f, 0.858f, 0.832f),
    MEDIUM("Lowfat Chocolate Milk", 0.64925f, 0.83916f, 1.1057f, 0.0115f, 0.0368f, 0.1564f,
           0.934f, 0.927f, 0.916f),
    MEDIUM("Regular Chocolate Milk", 1.4585f, 2.1289f, 2.9527f, 0.010063f, 0.043125f, 0.14375f,
           0.862f, 0.838f, 0.806f),
    MEDIUM("Coke", 8.9053e-05f, 8.372e-05f, 1.001e-05f, 0.10014f, 0.16503f, 0.2468f, 0.95f,
           0.95f, 0.0f),
    MEDIUM("Pepsi", 6.1697e-05f, 4.2564e-05f, 1.001e-05f, 0.091641f, 0.14158f, 0.20729f, 0.926f,
           0.95f, 0.0f),
    MEDIUM("Sprite", 1.001e-05f, 1.001e-05f, 1.001e-05f, 0.001886f, 0.0018308f, 0.0020025f,
           0.943f, 0.95f, 0.95f),
    MEDIUM("Gatorade", 0.0024574f, 0.003007f, 0.0037325f, 0.024794f, 0.019289f, 0.008878f,
           0.933f, 0.933f, 0.935f),
    MEDIUM("Chardonnay", 1.7982e-05f, 1.3758e-05f, 1.2023e-05f, 0.010782f, 0.011855f, 0.023997f,
           0.914f, 0.95f, 0.95f),
    MEDIUM("White Zinfandel", 1.7501e-05f, 1.9069e-05f, 1.288e-05f, 0.012072f, 0.016184f,
           0.019843f, 0.919f, 0.943f, 0.95f),
    MEDIUM("Merlot", 2.1129e-05f, 1.001e-05f, 1.001e-05f, 0.11632f, 0.25191f, 0.29434f, 0.95f,
           0.0f, 0.0f),
    MEDIUM("Budweiser Beer", 2.4356e-05f, 2.4079e-05f, 1.0564e-05f, 0.011492f, 0.024911f,
           0.057786f, 0.917f, 0.95f, 0.95f),
    MEDIUM("Coors Light Beer", 5.0922e-05f, 4.301e-05f, 1.001e-05f, 0.006164f, 0.013984f,
           0.034983f, 0.918f, 0.95f, 0.0f),
    MEDIUM("Clorox", 0.0024035f, 0.0031373f, 0.003991f, 0.0033542f, 0.014892f, 0.026297f,
           0.912f, 0.905f, 0.892f),
    MEDIUM("Apple Juice", 0.00013612f, 0.00015836f, 0.000227f, 0.012957f, 0.023741f, 0.052184f,
           0.947f, 0.949f, 0.945f),
    MEDIUM("Cranberry Juice", 0.00010402f, 0.00011646f, 7.8139e-05f, 0.039437f, 0.094223f,
           0.12426f, 0.947f, 0.95f, 0.95f),
    MEDIUM("Grape Juice", 5.382e-05f, 1.001e-05f, 1.001e-05f, 0.10404f, 0.23958f, 0.29325f,
           0.95f, 0.0f, 0.0f),
    MEDIUM("Ruby Grapefruit Juice", 0.011002f, 0.010927f, 0.011036f, 0.085867f, 0.18314f,
           0.25262f, 0.929f, 0.929f, 0.931f),
    MEDIUM("White Grapefruit Juice", 0.22826f, 0.23998f, 0.32748f, 0.0138f, 0.018831f,
           0.056781f, 0.548f, 0.545f, 0.565f),
    MEDIUM("Shampoo", 0.0007176f, 0.0008303f, 0.0009016f, 0.014107f, 0.045693f, 0.061717f,
           0.91f, 0.905f, 0.92f),
    MEDIUM("Strawberry Shampoo", 0.00015671f, 0.00015947f, 1.518e-05f, 0.01449f, 0.05796f,
           0.075823f, 0.927f, 0.935f, 0.95f),
    MEDIUM("Head & Shoulders Shampoo", 0.023805f, 0.028804f, 0.034306f, 0.084621f, 0.15688f,
           0.20365f, 0.911f, 0.896f, 0.884f),
    MEDIUM("Lemon Tea Powder", 0.040224f, 0.045264f, 0.051081f, 2.4288f, 4.5757f, 7.2127f,
           0.946f, 0.946f, 0.949f),
    MEDIUM("Orange Powder", 0.00015617f, 0.00017482f, 0.0001762f, 0.001449f, 0.003441f,
           0.007863f, 0.919f, 0.918f, 0.922f),
    MEDIUM("Pink Lemonade Powder", 0.00012103f, 0.00013073f, 0.00012528f, 0.001165f, 0.002366f,
           0.003195f, 0.902f, 0.902f, 0.904f),
    MEDIUM("Cappuccino Powder", 1.8436f, 2.5851f, 2.1662f, 35.844f, 49.547f, 61.084f, 0.849f,
           0.843f, 0.926f),
    MEDIUM("Salt Powder", 0.027333f, 0.032451f, 0.031979f, 0.28415f, 0.3257f, 0.34148f, 0.802f,
           0.793f, 0.821f),
    MEDIUM("Sugar Powder", 0.00022272f, 0.00025513f, 0.000271f, 0.012638f, 0.031051f, 0.050124f,
           0.921f, 0.919f, 0.931f),
    MEDIUM("Suisse Mocha Powder", 2.7979f, 3.5452f, 4.3365f, 17.502f, 27.004f, 35.433f, 0.907f,
           0.894f, 0.888f),
    MEDIUM("Pacific Ocean Surface Water", 0.0001764f, 0.00032095f, 0.00019617f, 0.031845f,
           0.031324f, 0.030147f, 0.902f, 0.825f, 0.914f),
};

const struct prt_material *prt_material_named_medium(unsigned index)
{
    return index < sizeof media / sizeof *media ? &media[index] : NULL;
}
