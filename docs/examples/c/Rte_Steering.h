/* The ports of the software component Steering, as the generator of an RTE writes them: in a car
 * each name is a signal of COM, here a member of rte_steering.
 */
#ifndef RTE_STEERING_H
#define RTE_STEERING_H

#include "firmware.h"

typedef uint8_t Std_ReturnType;
#define E_OK ((Std_ReturnType)0u)
#define RTE_E_MAX_AGE_EXCEEDED ((Std_ReturnType)64u)

/* A received signal: COM has checked the frame's protection, and sets 'state' each tick. */
struct rte_signal {
    real value;
    Std_ReturnType state;
};

struct rte_steering {
    struct rte_signal reference;
    struct rte_signal measurement;
    struct firmware_answer answer;
};

extern struct rte_steering rte_steering;

/* Names by AUTOSAR_SWS_RTE: Rte_Read_<port>_<data element>, Rte_Write_<port>_<data element>. */
#define RTE_READ(signal, to) (*(to) = rte_steering.signal.value, rte_steering.signal.state)
#define RTE_WRITE(member, from) (rte_steering.answer.member = (from), E_OK)

#define Rte_Read_Reference_Value(to) RTE_READ(reference, to)
#define Rte_Read_Measurement_Value(to) RTE_READ(measurement, to)
#define Rte_Write_SteeringTorque_Value(from) RTE_WRITE(command_1, from)
#define Rte_Write_ForceDifference_Value(from) RTE_WRITE(command_2, from)
#define Rte_Write_Status_FaultEstimate(from) RTE_WRITE(fault_estimate, from)
#define Rte_Write_Status_Mode(from) RTE_WRITE(mode, from)
#define Rte_Write_Status_FaultState(from) RTE_WRITE(fault_state, from)
#define Rte_Write_Status_Verdict(from) RTE_WRITE(verdict, from)

/* Runnables: at start-up, and by a TimingEvent with the period of the scenario's tick. */
void Steering_Init(void);
void Steering_Step(void);

#endif
