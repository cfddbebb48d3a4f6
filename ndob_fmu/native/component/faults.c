/* Why a printed function has no value, as Python says it. */
static const char *const FAULTS[] = {"", "no result", "float division by zero", "math domain error", "math range error",
                                      "(34, 'Numerical result out of range')"};
static const char *const CLASSES[] = {"", "ValueError", "ZeroDivisionError", "ValueError", "OverflowError", "OverflowError"};
