void recorder_begin(int decision);
int recorder_condition(int decision, int number, int holds);
int recorder_end(int decision, int holds);
