/* Type and item size of an array of any type and rank. */

#include <ISO_Fortran_binding.h>

void battery_describe(const CFI_cdesc_t *values, int *is_real, int *is_integer, int *bytes)
{
    *is_real = values->type == CFI_type_float || values->type == CFI_type_double;
    *is_integer = values->type == CFI_type_int32_t || values->type == CFI_type_int64_t;
    *bytes = (int)values->elem_len;
}
