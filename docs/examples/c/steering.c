/* The software component Steering of AUTOSAR Classic: the law between the ports of its RTE. */
#include <math.h>

#include "Rte_Steering.h"
#include "self_test.h"

static struct layout_state state;
static bool is_fit;

void Steering_Init(void)
{
    is_fit = self_test(&state);
    firmware_init(&state);
}

void Steering_Step(void)
{
    real reference;
    real measurement;

    if (Rte_Read_Reference_Value(&reference) != E_OK) {
        reference = (real)NAN; /* missing: the law holds */
    }
    if (Rte_Read_Measurement_Value(&measurement) != E_OK) {
        measurement = (real)NAN;
    }
    if (is_fit) {
        const struct firmware_answer answer = firmware_step(&state, reference, measurement);

        (void)Rte_Write_SteeringTorque_Value(answer.command_1);
        (void)Rte_Write_ForceDifference_Value(answer.command_2);
        (void)Rte_Write_Status_FaultEstimate(answer.fault_estimate);
        (void)Rte_Write_Status_Mode(answer.mode);
        (void)Rte_Write_Status_FaultState(answer.fault_state);
        (void)Rte_Write_Status_Verdict(answer.verdict);
    }
}
